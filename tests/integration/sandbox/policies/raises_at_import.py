# expect: import_error
# where: load
import module_that_is_not_there
