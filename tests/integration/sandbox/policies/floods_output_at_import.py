# expect: output_flood
# where: load
while True:
    print("x" * 1000)
