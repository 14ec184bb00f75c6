"""Old place of MUSHRA."""  # kept until all branches are in

from feel321.protocols.tasks import PROTOCOLS

MUSHRA = PROTOCOLS["mushra"]
