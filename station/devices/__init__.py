"""One module for each device of a station: its driver. A twin of each is in `station/twin`."""
