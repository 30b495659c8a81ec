"""The console of a station: what its operator sees and decides, on a page of the station's own machine."""
