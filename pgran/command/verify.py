"""`pgran verify`: whether a result is as it was written."""

import argparse

from pgran import errors


def verify(words):
    """Say whether a result is as it was written, by its checksum. Not collective."""
    parser = argparse.ArgumentParser("pgran verify", description=verify.__doc__.split(". ")[0])
    parser.add_argument("result", help="HDF5 file that pgran run has written")
    given = parser.parse_args(words)
    from pgran.files.seal import check_seal

    check_seal(given.result)
    print(f"{given.result}: as it was written")
    return errors.DONE
