"""The published forms of a leaderboard: its page, and the tables and figures of a paper."""
