"""A participant's gel: its drawn surface checked, meshed, and its driven and sensing faces found from its geometry."""
