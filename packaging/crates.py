#!/usr/bin/env python3
"""Prints the crates in the program as CycloneDX 1.5, with version, licence, SHA-256 and dependencies.

    packaging/crates.py [--features LIST]

By `cargo metadata` and Cargo.lock: what the program is built of on any system, without what only tests need.
"""
import argparse
import json
import pathlib
import subprocess
import tomllib

ROOT = pathlib.Path(__file__).resolve().parents[1]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--features", default="")
    features = parser.parse_args().features
    command = ["cargo", "metadata", "--format-version", "1", "--locked", "--features", features]
    metadata = json.loads(subprocess.run(command, cwd=ROOT, check=True, capture_output=True).stdout)
    packages = {package["id"]: package for package in metadata["packages"]}
    lock = tomllib.loads((ROOT / "Cargo.lock").read_text(encoding="utf-8"))["package"]
    sums = {(package["name"], package["version"]): package.get("checksum") for package in lock}
    needs = {node["id"]: sorted(other["pkg"] for other in node["deps"] if any(kind["kind"] != "dev" for kind in other["dep_kinds"]))
             for node in metadata["resolve"]["nodes"]}
    root = metadata["resolve"]["root"]
    found, waiting = set(), [root]
    while waiting:
        crate = waiting.pop()
        if crate not in found:
            found.add(crate)
            waiting += needs[crate]

    def purl(crate):
        return f"pkg:cargo/{packages[crate]['name']}@{packages[crate]['version']}"

    def component(crate):
        package = packages[crate]
        entry = {"type": "application" if crate == root else "library", "bom-ref": purl(crate), "name": package["name"],
                 "version": package["version"], "purl": purl(crate)}
        if package["license"]:
            # Some still write a slash for "or".
            entry["licenses"] = [{"expression": package["license"].replace(" / ", " OR ").replace("/", " OR ")}]
        if content := sums.get((package["name"], package["version"])):
            entry["hashes"] = [{"alg": "SHA-256", "content": content}]
        return entry

    crates = sorted(found, key=purl)
    print(json.dumps({
        "bomFormat": "CycloneDX", "specVersion": "1.5", "version": 1,
        "metadata": {"component": component(root)},
        "components": [component(crate) for crate in crates if crate != root],
        "dependencies": [{"ref": purl(crate), "dependsOn": [purl(other) for other in needs[crate]]} for crate in crates],
    }, indent=1))


if __name__ == "__main__":
    main()
