# expect: cpu_time
# where: load
# limits: start_cpu_s=0.5
while True:
    pass
