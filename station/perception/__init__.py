"""What a station sees in the pictures of its tactile sensors."""
