"""Programs that speak the bytes of the devices in their place: pseudo-terminals, TCP and streams of pictures.

They share no code with the drivers, so that the same mistake is not made twice.
"""
