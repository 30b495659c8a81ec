# expect: protocol_violation
# where: load
import os
import time

from channel_tools import channel, frame


os.write(channel(), frame(1, "loaded", [], b"", code="", message=""))
time.sleep(60)
