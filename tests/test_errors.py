"""Each kind of fault has its exit code, and each code its meaning."""

import pytest

from tofmix.errors import (
    EXIT_CODE_MEANINGS,
    BadInputError,
    ExitCode,
    StorageError,
    TofmixError,
    UsageError,
    os_error_text,
)


@pytest.mark.parametrize(("kind", "code"), [(UsageError, 2), (BadInputError, 3), (StorageError, 4)])
def test_exit_codes_have_the_values_of_the_contract(kind: type[TofmixError], code: int) -> None:
    assert kind("x").exit_code == code


def test_every_code_has_a_meaning() -> None:
    assert set(EXIT_CODE_MEANINGS) == set(ExitCode)


def test_the_text_of_an_os_error_has_no_number() -> None:
    assert os_error_text(FileNotFoundError(2, "No such file or directory"), "a.h5") == "a.h5: No such file or directory"
    assert os_error_text(OSError("odd"), "a.h5") == "a.h5: odd"
