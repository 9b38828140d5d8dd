"""The quick report on one scene writes its page; the parts say what they should."""

import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni import report
from groupoid_gni.reports import Peer, PeerRun, sections
from groupoid_gni.reports.cold_start import cold_start
from groupoid_gni.reports.deficiencies import KNOWN, numbered
from groupoid_gni.reports.machine_facts import machine_facts
from groupoid_gni.reports.page import write_report
from groupoid_gni.reports.report_scenes import SCENES, flows, methods_for


@pytest.fixture(scope="module")
def comparisons():
    def peers(name, scene, t_end, quick):
        exact = scene.exact(np.array([t_end]))[1][0]
        shift = np.eye(len(exact))[0]
        return [Peer("rival", (1e-2, 1e-7), lambda tol: PeerRun(tol**-0.2 * 1e-6, np.zeros(0),
                     exact + tol * shift), "honestly")]  # fmt: skip

    return sections.Comparisons(peers, ("absent: nobody",), ("pytest",))


@pytest.fixture(scope="module")
def page(tmp_path_factory, comparisons):
    folder = tmp_path_factory.mktemp("report")
    said = []
    path = write_report(
        folder, quick=True, scenes=["suslov"], comparisons=comparisons, say=said.append
    )
    assert path == folder / "measured_results.md"
    assert any(line.startswith("suslov") for line in said)
    return path


def test_the_page_has_its_chapters_and_its_figure(page):
    text = page.read_text(encoding="utf-8")
    for title in (
        "# Measured results", "## Speed against error", "### suslov", "## Wins and losses",
        "## What a step costs", "## Known deficiencies",
    ):  # fmt: skip
        assert f"{title}\n" in text
    assert "(measured/suslov.md)" in text
    settings = (page.parent / "measured" / "suslov.md").read_text(encoding="utf-8")
    assert settings.count("| ReferenceFlow |") >= 5
    assert "figures/measured_speed_suslov.png" in text
    assert (page.parent / "figures" / "measured_speed_suslov.png").stat().st_size > 10_000
    assert "absent: nobody" in text
    assert "rival: honestly" in text
    assert "pytest 9" in text or "pytest 8" in text


def test_the_page_says_who_won(page):
    text = page.read_text(encoding="utf-8")
    chapter = text.split("## Wins and losses")[1].split("\n## ")[0]
    lines = [line for line in chapter.splitlines() if line.startswith("- ")]
    assert len(lines) == 4
    assert "peers rival" in lines[1]
    assert "won, " in lines[1] or "lost, " in lines[1]
    assert "rival" not in lines[3]
    assert "Of 2 pairs" in chapter


def test_scenes_that_there_are_not_are_refused(tmp_path):
    with pytest.raises(gni.InputError, match="scenes must be some of rolling_ball"):
        write_report(tmp_path, scenes=["pendulum"])


def test_every_scene_of_the_report_can_be_stepped_by_most_methods():
    assert len(SCENES) >= 8
    for entry in SCENES:
        scene = entry.make()
        assert {"Rattle", "GNI 2", "GNI 4", "GNI 8"} <= set(methods_for(scene, True))
        assert len(entry.steps(False)) > len(entry.steps(True)) >= 5
    assert len(flows(False)) == 12


def test_deficiencies_are_numbered_with_cause_and_remedy():
    text = numbered()
    assert text.count("Cause:") == text.count("Remedy:") == len(KNOWN)
    assert text.splitlines()[-1].startswith(f"{len(KNOWN)}. ")


def test_machine_facts_name_processor_and_versions():
    text = machine_facts(["pytest", "a package that is not there"])
    assert "numpy 2" in text
    assert "pytest" in text
    assert "not there" not in text


def test_the_command_takes_peers_from_a_file(tmp_path, monkeypatch, capsys):
    source = tmp_path / "rivals.py"
    source.write_text(
        "from groupoid_gni.reports.sections import Comparisons\n"
        "def comparisons():\n"
        "    return Comparisons(lambda *request: [], ('nobody came',))\n"
    )
    asked = {}

    def kept(output, **options):
        asked.update(options, output=output)
        return output / "page.md"

    monkeypatch.setattr(report, "write_report", kept)
    arguments = ["--quick", "--output", str(tmp_path), "--peers", str(source), "--scenes", "suslov"]
    assert report.main(arguments) == 0
    assert asked["quick"]
    assert asked["scenes"] == ["suslov"]
    assert asked["comparisons"].notes == ("nobody came",)
    assert "page.md" in capsys.readouterr().out
    report.main(["--no-peers", "--output", str(tmp_path)])
    assert asked["comparisons"] is None
    assert asked["scenes"] is None
    assert report.comparisons_from(tmp_path / "nothing.py") is None
    source.write_text("peers = 3\n")
    with pytest.raises(gni.InputError, match="must have a function comparisons"):
        report.comparisons_from(source)


def test_a_drifting_energy_is_called_so():
    scene = gni.scenes.constrained_particle(1.3, 0.9, 0.7)
    run = gni.integrate(scene.system, scene.start, step=0.05, n_steps=4000, method=gni.GNI())
    assert sections._drift_in_words(run) == "flat"
    short = gni.integrate(scene.system, scene.start, step=0.05, n_steps=3, method=gni.GNI())
    assert sections._drift_in_words(short) not in ("", "flat")


@pytest.mark.slow
def test_a_cold_start_is_the_sum_of_its_parts_and_of_starting():
    found = cold_start("chaplygin_sleigh", repeats=1)
    parts = (found.imports, found.record, found.differentiate, found.emit, found.compile, found.run)
    assert all(part > 0.0 for part in parts)
    assert 0.3 * sum(parts) < found.whole < 5.0 * sum(parts) + 1.0


@pytest.mark.slow
def test_the_parts_about_other_scenes_are_written(tmp_path):
    request = sections.Request(True, tmp_path, SCENES[:1], lambda text: None)
    energy = sections.energy_over_a_long_run(request)
    assert "linear drift" in energy
    assert (tmp_path / "figures" / "measured_energy.png").exists()
    assert "times the loop" in sections.ensembles(request)
