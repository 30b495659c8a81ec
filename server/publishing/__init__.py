"""What of a final contest is published: files, archive, export of receipts."""
