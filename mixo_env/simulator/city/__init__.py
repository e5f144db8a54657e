"""The city: streets, houses, trees, parked cars and their textures, as patches."""
