"""A deterministic procedural city, seen through a six-camera rig and written in nuScenes format."""
