"""Episodes: played or re-simulated, and the records that they leave."""
