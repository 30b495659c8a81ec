"""The state of the whole service, for Prometheus and for the organizers' page."""
