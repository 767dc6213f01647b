"""Cameras and lenses: poses by pycolmap, lenses from files, images without distortion."""
