"""The sensors that come with thzcl, one file each, on the same hook as anybody's."""
