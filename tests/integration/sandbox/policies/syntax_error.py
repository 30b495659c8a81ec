# expect: import_error
# where: load
class Policy:
  def reset(self
