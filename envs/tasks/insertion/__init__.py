"""What all tasks share in which a peg between two upright gels goes into a hole below it; no task by itself."""
