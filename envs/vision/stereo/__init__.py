"""Depth as an active stereo camera measures it: projected dots, two infrared pictures, matching, registration."""
