# expect: crashed
# where: load
import os

os._exit(0)
