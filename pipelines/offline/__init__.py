"""The offline half: cameras, and depth of every camera, computed before rendering."""
