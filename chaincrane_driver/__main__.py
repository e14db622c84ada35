"""python -m chaincrane_driver: the command chaincrane."""

import sys

from .cli import main

sys.exit(main())
