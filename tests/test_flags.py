"""One definition of the status, whole and in the order of the contract."""

from tofmix.flags import STATUS_MEANINGS, Status, mixing_name, status_name


def test_every_status_has_a_meaning_and_the_contracts_value() -> None:
    names = ["ok", "too_few_samples", "not_converged", "no_surface", "degenerate"]
    assert [status_name(value) for value in range(5)] == names
    assert set(STATUS_MEANINGS) == set(Status)


def test_values_without_a_name_are_named_by_their_number() -> None:
    assert (status_name(9), mixing_name(9)) == ("status_9", "mixing_9")
