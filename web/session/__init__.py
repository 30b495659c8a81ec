"""The browser's session: its signed cookie, and the forms that belong to it."""
