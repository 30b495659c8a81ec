"""Claims shards of evaluations, runs them through the evaluator in the sandbox and reports."""
