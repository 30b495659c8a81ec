"""What of a final competition is published: files, archive, export of receipts."""
