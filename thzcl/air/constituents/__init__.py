"""The constituents that come with thzcl, one file each, on the hook that any plugin uses."""
