"""What every process of the service counts, and the totals of all processes in the database."""
