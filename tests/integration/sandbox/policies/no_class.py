# expect: import_error
# where: load
POLICY = None
