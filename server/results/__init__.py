"""What follows from final boards: who advances, who wins, and what is published of it."""
