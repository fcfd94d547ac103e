"""Carries a robot through the workbench in headless Chromium: from an empty directory to the certificate.

    pip install playwright axe-playwright-python
    python tests/clients/workbench.py target/release/dbbd OUT

Serves an empty directory behind a token, signs in, makes a robot by the form, sees a plan refused, mends it, runs the demo at
20 times the speed of a real cell, corrects a program, plans and measures a check, and makes the certificate. Then compares the
result with that of the command line on the same run. Screenshots go to OUT.
"""

import json
import pathlib
import re
import shutil
import subprocess
import sys

from browser import AXE, CHROMIUM, expect, serve, sync_playwright

DBBD, OUT = pathlib.Path(sys.argv[1]).resolve(), pathlib.Path(sys.argv[2]).resolve()
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
TOKEN = "a-token-for-the-workbench"
said = []


def configure(cell):
    (cell / "token").write_text(TOKEN)
    (cell / "token").chmod(0o600)
    (cell / "dbbd.toml").write_text('address = "127.0.0.1:0"\ntoken_file = "token"\n')


class Story:
    def __init__(self, browser, url):
        self.url = url
        self.page = browser.new_context(viewport={"width": 1400, "height": 1000}, locale="en-GB").new_page()
        self.page.on("console", lambda m: self.complain(m.text))
        self.page.on("pageerror", lambda error: said.append(str(error)))
        self.shots = 0

    def complain(self, text):
        # What the story provokes: no token yet, and refused jobs.
        if not re.search(r"40[19]|422", text):
            said.append(text)

    def step(self, name):
        return self.page.locator(f"[data-step={name}]")

    def next(self, name):
        self.step(name).locator("[data-action=next]").click()

    def state(self, name, wanted, seconds=120):
        expect(self.step(name)).to_have_attribute("data-state", wanted, timeout=1000 * seconds)

    def look(self, what):
        """A screenshot and what axe says, at the desk and on the phone."""
        self.shots += 1
        for size, width in (("desktop", 1400), ("phone", 390)):
            self.page.set_viewport_size({"width": width, "height": 900})
            self.page.screenshot(path=OUT / f"{self.shots:02}-{what}-{size}.png", full_page=True)
            self.page.evaluate(AXE)
            found = self.page.evaluate("(rules) => axe.run({ runOnly: rules })", RULES)
            for one in found["violations"]:
                print("axe", what, size, one["id"], [node["html"][:150] for node in one["nodes"]][:3])
                said.append(f"axe: {one['id']} in {what}")
            wide = self.page.evaluate("document.documentElement.scrollWidth - innerWidth")
            assert wide <= 0, f"{what}, {size}: {wide} px too wide"
        self.page.set_viewport_size({"width": 1400, "height": 1000})

    def sign_in(self):
        self.page.goto(self.url)
        dialog = self.page.locator("[data-sign-in]")
        expect(dialog).to_be_visible(timeout=10_000)
        self.look("sign-in")
        dialog.locator("input").fill(TOKEN)
        dialog.locator("button").click()
        expect(dialog).to_be_hidden()

    def make_a_robot(self):
        """By the form. A bar that no robot reaches is refused with its cure, and the mended job is planned."""
        self.page.locator("[data-action=new-robot]").click()
        form = self.page.locator("#new-form")
        form.locator("[data-name=name]").fill("cell-1")
        form.locator("[data-name=length_mm]").fill("0.3")
        form.locator("[data-action=save]").click()
        expect(form.locator("[role=alert]")).not_to_be_empty(timeout=10_000)
        self.look("units")
        form.locator("[data-name=length_mm]").fill("300")
        form.locator("[data-name=x_mm]").fill("9300")
        form.locator("[data-action=save]").click()
        self.page.wait_for_url("**/robot/cell-1")
        self.state("cell", "done")
        self.next("plan")
        self.state("plan", "attention")
        expect(self.step("plan").locator("[data-verdict]")).to_have_attribute("data-verdict", "fail")
        expect(self.step("plan")).to_contain_text("Cure: ")
        self.look("refused")
        self.next("cell")
        job = self.page.locator("#job-form")
        job.locator("[data-name=x_mm]").fill("1300")
        job.locator("[data-action=save]").click()
        self.next("plan")
        self.state("plan", "done")
        self.next("programs")
        self.state("programs", "done")
        self.state("measure", "ready")

    def demo(self):
        self.page.goto(self.url)
        expect(self.page.get_by_role("link", name="cell-1")).to_be_visible(timeout=10_000)
        self.page.locator("[data-action=demo]").click()
        self.page.wait_for_url("**/robot/demo")
        self.state("programs", "done")
        self.halt("measure")
        self.state("result", "done", 180)
        self.look("result")

    def halt(self, step):
        button = self.step(step).locator("[data-action=next]")
        expect(button).to_contain_text("mounted", timeout=60_000)
        button.click()
        self.state(step, "running", 30)
        expect(self.page.locator("#stop")).to_be_visible()
        if step == "measure":
            self.look("running")

    def scene(self):
        scene = self.page.locator("[data-scene]")
        scene.locator("summary").first.click()
        expect(scene.locator("#scene-rows tr").nth(100)).to_be_attached(timeout=20_000)
        before = int(scene.get_attribute("data-pose"))
        scene.locator("#scene-next").click()
        assert int(scene.get_attribute("data-pose")) > before
        scene.locator("#scene-play").click()
        expect(scene).to_have_attribute("data-playing", "true")
        scene.locator("#scene-play").click()
        expect(scene).to_have_attribute("data-playing", "false")
        scene.locator("#scene-arrows").check()
        self.look("scene")
        scene.locator("summary").first.click()

    def correct(self, cell):
        program = cell / "demo" / "program"
        names = ["DBB_MAIN.src", "DBB_MAIN.dat", *(file.name for file in sorted(program.glob("DBB_C*")))]
        self.page.locator("#program").set_input_files([program / name for name in names])
        expect(self.step("correct").locator("[data-action=next]")).to_contain_text("Correct", timeout=10_000)
        self.next("correct")
        self.state("correct", "done")
        expect(self.page.locator("#shift-rows tr").nth(10)).to_be_attached(timeout=10_000)
        corrected = {file.name for file in (cell / "demo" / "corrected").iterdir()}
        assert corrected >= {name for name in names if name.endswith(".src")}, corrected
        with self.page.expect_download() as downloaded:
            self.page.locator("#download").click()
        downloaded.value.save_as(OUT / "corrected.zip")
        self.look("correct")

    def check(self):
        self.page.locator("#tolerance").fill("5")
        check = self.step("check").locator("[data-action=next]")
        for label in ("Plan the check", "Write the programs", "Measure the check|Start"):
            expect(check).to_contain_text(re.compile(label), timeout=120_000)
            check.click()
        # A run of the check leads to the check, and is no run of the calibration.
        self.halt("check")
        expect(check).to_have_text("Decide", timeout=180_000)
        self.state("result", "done")
        expect(self.step("programs")).to_contain_text("Files in program")
        check.click()
        self.state("check", "done")
        assert self.step("check").locator("[data-verdict]").get_attribute("data-verdict") in ("pass", "fail", "undecided")

    def certificate(self):
        self.next("certificate")
        self.state("certificate", "done")
        self.look("certificate")


def same_as_the_command_line(cell):
    """The result of the page is that of the command which the page shows."""
    runs = sorted((cell / "dbbd-runs").glob("*/run.dbbd"), key=lambda path: path.stat().st_mtime)
    run = runs[0]
    subprocess.run([DBBD, "--quiet", "identify", run, "--out", cell / "again"], stdout=subprocess.DEVNULL, timeout=120)
    one, other = (json.loads((cell / at / "result.json").read_text()) for at in ("demo/result", "again"))
    assert one["parameters"] == other["parameters"]
    assert [file.name for file in sorted((cell / "demo/result").iterdir())] == [file.name for file in sorted((cell / "again").iterdir())]
    shutil.rmtree(cell / "again")


def main():
    OUT.mkdir(parents=True, exist_ok=True)
    cell = OUT / "cell"
    shutil.rmtree(cell, ignore_errors=True)
    cell.mkdir()
    configure(cell)
    service, url = serve(DBBD, cell)
    try:
        with sync_playwright() as playwright:
            graphics = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", *graphics])
            story = Story(browser, url)
            story.sign_in()
            story.make_a_robot()
            story.demo()
            story.scene()
            story.correct(cell)
            story.check()
            story.certificate()
            browser.close()
        same_as_the_command_line(cell)
    finally:
        service.terminate()
        service.wait()
    print("console and axe:", said or "silent")
    assert not said


main()
