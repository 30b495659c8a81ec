"""Who wins what, and the end of a competition."""
