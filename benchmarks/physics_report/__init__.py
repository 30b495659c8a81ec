"""The figures of docs/physics.md: measured on replayed episodes, laid out as tables, written into the page."""
