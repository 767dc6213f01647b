"""Procedural worlds: a dynamic room or garden, filmed by a rig, in the layout of any data set, with
exact depth.
"""
