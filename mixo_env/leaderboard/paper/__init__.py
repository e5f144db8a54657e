"""The paper's tables and figures, made from a leaderboard: `mixo benchmark --paper`."""
