"""Drives the live page in headless Chromium: a whole run on the virtual bar, from its start to its report.

    pip install playwright; npm pack axe-core && tar xzf axe-core-*.tgz
    python tests/clients/page.py target/release/dbbd OUT [package/axe.min.js] [/usr/bin/chromium]

Makes a plan of few poses, simulates the cell, serves it, and looks at the page as an operator would. Screenshots go to
OUT. Ends with an error when something that must be there is not, when the console said an error, or when axe found
something.
"""

import pathlib
import re
import shutil
import signal
import subprocess
import sys
import time

from playwright.sync_api import expect, sync_playwright

DBBD, OUT = pathlib.Path(sys.argv[1]).resolve(), pathlib.Path(sys.argv[2]).resolve()
AXE = pathlib.Path(sys.argv[3]) if len(sys.argv) > 3 else None
CHROMIUM = sys.argv[4] if len(sys.argv) > 4 else shutil.which("chromium")
JOB = pathlib.Path(__file__).parents[2] / "examples" / "demo.toml"
URL = "http://127.0.0.1:8231/"

# What the console, the pages and axe complained about.
said = []


def prepare(cell):
    shutil.rmtree(cell, ignore_errors=True)
    cell.mkdir(parents=True)
    job = JOB.read_text().replace("points = 80", "points = 24")
    (cell / "job.toml").write_text(job)
    (cell / "dbbd.toml").write_text('address = "127.0.0.1:8231"\n[device]\nport = "bar"\n')
    for step in (["plan", "job.toml", "--out", "plan"], ["krl", "plan/plan.csv", "--out", "krl"]):
        subprocess.run([DBBD, "--quiet", *step], cwd=cell, check=True, timeout=120, stdout=subprocess.DEVNULL)


def simulate(cell, speed, *more):
    # Every run needs a cell of its own: the program ends with it.
    args = [DBBD, "simulate", "--program", "krl/DBB_MAIN.src", "--speed", str(speed), "--link", "bar", *more]
    return subprocess.Popen(args, cwd=cell, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def serve(cell):
    with open(cell / "serve.log", "a") as log:
        child = subprocess.Popen([DBBD, "serve", "--config", "dbbd.toml"], cwd=cell, stderr=log)
    time.sleep(1)
    return child


def check(page, what):
    if AXE is None:
        print(f"axe: not given, {what} not checked")
        return
    page.evaluate(AXE.read_text())
    found = page.evaluate("() => axe.run()")
    for one in found["violations"]:
        print("axe", what, one["id"], one["impact"], [node["html"][:120] for node in one["nodes"]][:3])
    print(f"axe {what}: {len(found['violations'])} violations, {len(found['passes'])} rules passed")
    said.extend(f"axe: {one['id']}" for one in found["violations"])


DELAYS = """() => new Promise((done) => {
  const [stream, delays] = [new EventSource("/api/v1/stream"), []];
  stream.addEventListener("frame", (event) => requestAnimationFrame(() => {
    delays.push(Date.now() - JSON.parse(event.data).unix_ms);
    if (delays.length === 100) { stream.close(); done(delays.sort((a, b) => a - b)); }
  }));
})"""


def main():
    OUT.mkdir(parents=True, exist_ok=True)
    cell = OUT / "cell"
    prepare(cell)
    robot, service = simulate(cell, 8), serve(cell)

    try:
        with sync_playwright() as playwright:
            # The policy of the page forbids scripts of others; only axe needs it out of the way.
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
            context = browser.new_context(viewport={"width": 1400, "height": 1000}, color_scheme="light")
            page = context.new_page()
            cut = [False]
            page.on("console", lambda m: said.append(m.text) if m.type in ("error", "warning") and not cut[0] else None)
            page.on("pageerror", lambda error: said.append(str(error)))
            page.goto(URL)
            state = page.locator("#state")
            expect(state).to_have_text("ready")
            check(page, "idle, light")

            # From the page, by keyboard alone: name, plan, start.
            page.locator("#name").focus()
            page.keyboard.press("Control+A")
            page.keyboard.type("first")
            expect(page.locator("#plan")).to_have_value("plan")
            page.keyboard.press("Enter")
            expect(state).to_have_text("running", timeout=10_000)
            # Before the bar is mounted it stands at its end stop, which is no alarm.
            expect(page.locator("#detail")).to_have_text("No bar mounted: reading invalid", timeout=10_000)
            expect(page.locator("#alarm")).to_be_hidden()
            page.screenshot(path=OUT / "unmounted.png")
            points = page.locator("#plot circle:not(.ring):not(.nominal), #plot rect")
            expect(points.nth(5)).to_be_visible(timeout=60_000)
            few = points.count()
            expect(points.nth(few + 2)).to_be_attached(timeout=60_000)
            expect(page.locator("#poses-text")).to_contain_text(re.compile(r"^\d+ of \d+ poses"))
            expect(page.locator("#rate")).to_contain_text("a second")
            page.locator("#more").click()
            magnified = page.locator("#scale").inner_text()
            page.locator("#auto").click()
            print("polar plot grew from", few, "to", points.count(), "points; magnified:", magnified)
            delays = page.evaluate(DELAYS)
            print(f"from the byte to the next picture of the browser: median {delays[50]:.1f} ms, 99 % {delays[98]:.1f} ms")
            page.keyboard.press("m")
            page.keyboard.type("a remark from the page")
            page.keyboard.press("Enter")
            expect(page.locator("#message")).to_have_text("The remark was written.")
            page.screenshot(path=OUT / "running-light.png", full_page=True)
            check(page, "running, light")
            page.locator("#theme").click()
            page.screenshot(path=OUT / "running-dark.png", full_page=True)
            check(page, "running, dark")
            page.locator("#theme").click()

            # The connection breaks, without a word and without an end, and comes back; the run does not mind.
            cut[0] = True
            service.send_signal(signal.SIGSTOP)
            expect(page.locator("#link")).to_contain_text("no connection", timeout=15_000)
            page.screenshot(path=OUT / "cut.png")
            service.send_signal(signal.SIGCONT)
            expect(page.locator("#link")).to_have_text("", timeout=20_000)
            context.set_offline(True)
            page.wait_for_timeout(1000)
            context.set_offline(False)
            expect(page.locator("#link")).to_have_text("", timeout=20_000)
            cut[0] = False
            expect(state).to_have_text("running")
            print("cut and restored; points:", points.count())

            page.wait_for_timeout(6000)
            page.locator("#stop").click()
            expect(state).to_have_text("ready", timeout=15_000)
            expect(page.locator("#last")).to_contain_text("first")
            robot.terminate()
            robot.wait()

            row = page.locator("#runs tr", has_text="first")
            row.get_by_role("button", name="Identify").click()
            expect(page.locator("#jobs")).to_contain_text(re.compile("Identify of first: done"), timeout=90_000)
            report = row.get_by_role("link", name="report.html")
            expect(report).to_be_visible(timeout=10_000)
            with context.expect_page() as opened:
                report.click()
            opened.value.wait_for_load_state()
            assert "KUKA KR 60" in opened.value.content()
            assert opened.value.locator("svg").count() > 0
            opened.value.screenshot(path=OUT / "report.png")
            opened.value.close()
            page.screenshot(path=OUT / "results.png", full_page=True)
            check(page, "results, light")

            phone = browser.new_context(
                viewport={"width": 390, "height": 844}, device_scale_factor=2, color_scheme="dark", has_touch=True)
            small = phone.new_page()
            small.on("console", lambda m: said.append(m.text) if m.type == "error" else None)
            robot = simulate(cell, 10)
            small.goto(URL)
            expect(small.locator("#state")).to_have_text("ready", timeout=10_000)
            small.locator("#name").fill("phone")
            small.locator("#start").click()
            expect(small.locator("#state")).to_have_text("running", timeout=10_000)
            expect(small.locator("#poses-text")).to_contain_text(re.compile("^[3-9] of"), timeout=60_000)
            wide = small.evaluate("document.documentElement.scrollWidth")
            assert wide <= 390, f"the page is {wide} wide"
            small.screenshot(path=OUT / "phone.png", full_page=True)
            check(small, "phone, dark")
            small.locator("#stop").click()
            expect(small.locator("#state")).to_have_text("ready", timeout=15_000)
            # The port goes: everybody sees it.
            robot.terminate()
            expect(state).to_contain_text("no device", timeout=10_000)
            browser.close()
    finally:
        for child in (robot, service):
            child.terminate()
            child.wait()
    print("console:", said or "no error and no warning")
    assert not said


main()
