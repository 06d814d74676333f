"""What a device would be asked to do: counted by every test that says it does not grow."""

from torch.utils._python_dispatch import TorchDispatchMode

_READS = ("_local_scalar_dense", "nonzero")


class Launches(TorchDispatchMode):
    """Names of what torch is asked to do inside, views included."""

    def __init__(self):
        super().__init__()
        self.names = []

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        self.names.append(func.overloadpacket.__name__)
        return func(*args, **(kwargs or {}))

    def waits(self, *reads):
        """How often a number or a size is read, for which one waits."""
        return sum(name in (reads or _READS) for name in self.names)
