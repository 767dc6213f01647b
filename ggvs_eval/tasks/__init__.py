"""Made things: what a folder is made from, whether it is made, and how long the rest takes."""
