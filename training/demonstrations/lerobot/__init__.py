"""Data sets in the format of LeRobot, versions 2.1 and 3.0: written, read back and checked. Needs the extra `data`."""
