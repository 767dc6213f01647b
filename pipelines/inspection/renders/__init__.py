"""What is wrong with somebody's renders, and what somebody's number means."""
