"""The data that the pages show: the protocol, and its implementation on the service layer."""
