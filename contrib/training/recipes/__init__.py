"""What a learned baseline adds to the training that all of them share: its network, its loss, the view that validates."""
