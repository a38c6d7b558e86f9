"""What vibrates: balls and springs, who is held, in which order to eliminate them."""
