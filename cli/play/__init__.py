"""`vitac play`: a page on this machine where a person plays a task by touch."""
