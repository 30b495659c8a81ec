"""A scene of bodies: checked, laid out, built into arrays, and stepped."""
