"""A drive through it: route, traffic, clock, what the sensors say and where the cameras stand."""
