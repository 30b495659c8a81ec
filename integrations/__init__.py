"""What the harnesses of others load to play our tasks, a module for each."""
