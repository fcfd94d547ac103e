"""Reads the directory of a certificate with programs of others: pydcc, dccQuantities, pikepdf, and against a schema.

python3 tests/clients/read_certificate.py DIR
DBBD_DCC_XSD=dcc.xsd: also validates dcc.xml by this schema (lxml); its imports must be reachable from it.
"""
import os
import sys
import xml.etree.ElementTree as ET
from unittest.mock import MagicMock

directory = sys.argv[1]
path = os.path.join(directory, "dcc.xml")
text = open(path, "rb").read()
SI, DCC = "{https://ptb.de/si}", "{https://ptb.de/dcc}"
root = ET.fromstring(text)
assert root.tag == DCC + "digitalCalibrationCertificate" and root.get("schemaVersion") == "3.3.0"
for real in root.iter(SI + "real"):
    float(real.find(SI + "value").text)
    for expanded in real.iter(SI + "expandedMU"):
        assert float(expanded.find(SI + "valueExpandedMU").text) > 0

# It checks signatures, which are not read here, and knows no newer OpenSSL.
sys.modules["certvalidator"] = MagicMock()
import dcc.dcc

# It would fetch all schemas to validate; reading needs none.
dcc.dcc.DCCXMLValidator = object
read = dcc.dcc.DCC(byte_array=text)
assert read.is_loaded() and read.version() == "3.3.0", read.version()
assert read.mandatory_language() == "en" and read.uid().startswith(("draft-", "specimen")), read.uid()
print("pydcc: loaded, version", read.version(), "identifier", read.uid(), "laboratory", read.calibration_laboratory_name())

try:
    import metas_unclib  # noqa: F401
except Exception:  # its arithmetic needs .NET, which reading does not
    names = {name: type(name, (), {"__init__": lambda self, *values: None}) for name in ("ucomplex", "ufloat", "ucomplexarray", "ufloatarray")}
    sys.modules["metas_unclib"] = MagicMock(**names)
from dcc_quantities import DccQuantityType


def plain(element):
    """An element as the dictionaries that dccQuantities takes."""
    found = {"@" + name: value for name, value in element.attrib.items()}
    for child in element:
        name = child.tag.replace(SI, "si:").replace(DCC, "dcc:")
        inner = plain(child)
        if name in ("dcc:content", "dcc:quantity"):
            found.setdefault(name, []).append(inner)
        else:
            found[name] = inner
    text = (element.text or "").strip()
    if element.tag.startswith(SI) and not element.tag.endswith("unit") and not len(element):
        return float(text)
    if not len(element):
        return {**found, "$": text} if found else text
    return found


quantities = [DccQuantityType.from_dcc_data(plain(quantity)) for quantity in root.iter(DCC + "quantity")]
assert quantities
print("dccQuantities:", len(quantities), "quantities, such as", quantities[0])

schema = os.environ.get("DBBD_DCC_XSD")
if schema:
    from lxml import etree

    etree.XMLSchema(etree.parse(schema)).assertValid(etree.fromstring(text))
    print("valid by", schema)

pdf = os.path.join(directory, "certificate.pdf")
if os.path.exists(pdf):
    import pikepdf

    with pikepdf.open(pdf) as document:
        assert bytes(document.attachments["dcc.xml"].get_file().read_bytes()) == text, "another dcc.xml is embedded"
        with document.open_metadata() as metadata:
            assert metadata["pdfaid:part"] == "3" and metadata["pdfaid:conformance"] == "B", metadata
        print("pikepdf: PDF/A-3B,", len(document.pages), "pages, dcc.xml embedded")
