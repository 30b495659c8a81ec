"""What a score is: tracks, submissions, episodes, records, scoring. Used alike by the service and on a laptop."""
