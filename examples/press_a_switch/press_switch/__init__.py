"""A task of your own: press a switch by touch."""
