"""Studies of many scenes: a grid of settings, seeds and variants, one file a member."""
