"""The world that is filmed: a lit room or garden of meshes with procedural surfaces, laid out by a seed; metres."""
