"""What the REST API answers and the pages show."""
