"""Old place of DISSIMILARITY."""  # kept until all branches are in

from feel321.protocols.tasks import PROTOCOLS

DISSIMILARITY = PROTOCOLS["dissimilarity"]
