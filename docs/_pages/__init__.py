"""What writes the pages and figures of the documentation; nothing of it is installed."""
