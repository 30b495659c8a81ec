"""REST API: FastAPI app, routes and problem JSON."""
