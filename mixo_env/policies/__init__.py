"""Policies that weight experts: the rows of the leaderboard."""
