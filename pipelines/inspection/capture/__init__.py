"""What would spoil results on a capture, found before it is used."""
