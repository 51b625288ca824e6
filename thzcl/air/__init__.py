"""What air absorbs, and how humidity and radiance are measured."""
