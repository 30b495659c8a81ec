"""Appeals of teams against evaluations, and rulings."""
