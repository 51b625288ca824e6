"""The paths of rays through the air, traced from voxel to voxel."""
