"""A procedural dynamic room, seen by a rig like DyNeRF's, with exact depth: everything about it is known."""
