"""The leaderboard: policies on recordings, cross-validated, and the tables and figures they make."""
