"""Cases that vary images and how they are taken: noise, texture, light, stage, lens, cameras and frames."""
