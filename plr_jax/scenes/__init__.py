"""Ready-made planning problems (scenes), files of problems, and readers of maps in common file formats.

:func:`load` and :func:`save` are for scene files. Every ``read_...`` function takes the path of a map, and raises
``OSError`` if the file cannot be opened. :func:`read_workspace` chooses the reader by the file's ending and content.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the list is in __init__.pyi
