"""From files to the images and intrinsics that the graphs read."""
