"""What rays end on."""
