"""What rays go through on their way."""
