"""What organizers and judges decide: who advances, who wins, marks, rejudging, and what is published."""
