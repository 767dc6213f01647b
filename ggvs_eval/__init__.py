"""Offline-to-online evaluation of multi-view 3D video synthesis."""
