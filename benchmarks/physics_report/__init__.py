"""The figures of benchmarks/physics.md: measured on replayed episodes, laid out as tables, written into the page."""
