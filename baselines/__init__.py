"""Methods that the paper is compared with, behind one interface."""
