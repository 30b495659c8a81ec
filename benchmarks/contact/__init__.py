"""Contact against textbooks: `textbook.py` runs all checks, `rigid.py` and `elastic.py` have the experiments."""
