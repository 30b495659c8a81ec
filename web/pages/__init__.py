"""The pages: what each address answers, with error pages and static files."""
