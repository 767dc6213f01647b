"""What a person should look at before trusting depth: pictures of maps, confidence and rectified pairs, in one page."""
