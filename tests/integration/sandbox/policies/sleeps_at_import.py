# expect: start_timeout
# where: load
# limits: start_wall_s=1
import time

time.sleep(60)
