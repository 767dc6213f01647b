"""Depth of every camera, computed before anything is rendered: pair, rectify, match, fuse, store."""
