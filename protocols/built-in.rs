// The definitions that are built in: name and text.
&[
    ("dbb-cobs-1", include_str!("dbb-cobs-1.toml")),
    ("dbb-nmea-1", include_str!("dbb-nmea-1.toml")),
    ("dbb-csv-1", include_str!("dbb-csv-1.toml")),
    ("sylvac-opto", include_str!("sylvac-opto.toml")),
    ("heidenhain-nd28x", include_str!("heidenhain-nd28x.toml")),
    ("mitutoyo-idh", include_str!("mitutoyo-idh.toml")),
    ("mitutoyo-push", include_str!("mitutoyo-push.toml")),
    ("usdigital-qsb", include_str!("usdigital-qsb.toml")),
    ("microepsilon-ild1420", include_str!("microepsilon-ild1420.toml")),
    ("riftek-rf60x", include_str!("riftek-rf60x.toml")),
    ("cdi-starrett", include_str!("cdi-starrett.toml")),
    ("touchdro", include_str!("touchdro.toml")),
    ("modbus-rtu", include_str!("modbus-rtu.toml")),
]
