"""The world that is rendered: a lit room or garden of meshes with procedural surfaces, laid out by
a seed; metres.
"""
