"""A procedural dynamic room, seen by a rig like DyNeRF's, in any layout, with exact depth: everything about it is known."""
