"""eladapt: composite adaptive finite-time control for any robot with a URDF.

The public names and where they come from are in ``__init__.pyi``, which type checkers read. Each is imported
when it is asked for: a control loop on a robot's computer draws nothing, and the import takes milliseconds.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
