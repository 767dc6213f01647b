"""Demo rooms that ship, as they were filmed: a procedural dynamic room, seen by rigs like those of three data sets."""
