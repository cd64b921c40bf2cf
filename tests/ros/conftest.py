"""Everything here talks on a domain of its own and on this machine only."""

import os
import random

os.environ["ROS_DOMAIN_ID"] = str(random.randrange(1, 100))
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
