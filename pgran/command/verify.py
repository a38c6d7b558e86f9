"""`pgran verify`: whether a result is as it was written."""

from pgran import errors
from pgran.command.words import Parser


def verify(words):
    """Say whether a result is as it was written, by its checksum."""
    does = "Say by its checksum whether a result is unchanged (exit code 4 if not)."
    parser = Parser("verify", does, "pgran verify results/response.h5")
    parser.add_argument("result", metavar="RESULT", help="HDF5 file that pgran run has written")
    options = parser.parse_args(words)
    from pgran.store.paths import check_seal

    check_seal(options.result)
    print(f"{options.result}: as it was written")
    return errors.DONE
