"""Files of the service: content-addressed blobs in a local folder or a bucket."""
