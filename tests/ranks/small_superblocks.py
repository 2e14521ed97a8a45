"""The commands, with superblocks of one block of 256 bodies: small scenes have several."""

from particlerb.model import superblocks

superblocks.SUPERBLOCK = 256

if __name__ == "__main__":
    from particlerb.cli import entry

    entry()
