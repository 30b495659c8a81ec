"""What learns from episodes: the networks, who has them, and how what looks the same is used."""
