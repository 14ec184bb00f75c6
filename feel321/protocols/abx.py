"""Old place of ABX."""  # kept until all branches are in

from feel321.protocols.tasks import PROTOCOLS

ABX = PROTOCOLS["abx"]
