"""The release check tells what failed from what it could not check."""

import subprocess

import pytest

from stillpoint.scripts import release_check


def test_citation_names_the_version_of_the_package():
    assert [outcome.ended for outcome in release_check.check_citation()] == ["ok"]


def test_without_an_answer_of_the_database_vulnerabilities_are_not_checked(monkeypatch):
    silent = subprocess.CompletedProcess([], 1, "", "connection refused")
    monkeypatch.setattr(release_check, "_run_command", lambda command: silent)
    (outcome,) = release_check.check_vulnerabilities()
    assert (outcome.ended, outcome.detail) == ("not checked", "the database gave no answer: connection refused")


@pytest.mark.parametrize(
    ("licence", "free"), [("Apache Software License", True), ("BSD-3-Clause", True), ("GPL-3.0-only", False)]
)
def test_only_licences_that_an_mit_package_may_depend_on_are_free(licence, free):
    assert release_check._is_free("any", licence) is free


def test_a_missing_tool_is_named():
    made = release_check._run_command(["no-such-tool"])
    assert made.returncode == 127
    assert "no-such-tool is not installed" in made.stderr
