# expect: import_error
# where: load
raise SystemExit(0)
