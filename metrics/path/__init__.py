"""View consistency of images along a camera path, without reference."""
