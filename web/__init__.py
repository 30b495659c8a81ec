"""Server-rendered pages: leaderboards, submissions, track rules."""
