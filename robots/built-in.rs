// The robots that are built in: name and text.
&[
    ("kr60ha", include_str!("kr60ha.toml")),
    ("kr16-2", include_str!("kr16-2.toml")),
    ("kr120r2500pro", include_str!("kr120r2500pro.toml")),
    ("kr210r2700extra", include_str!("kr210r2700extra.toml")),
    ("kr6r900sixx", include_str!("kr6r900sixx.toml")),
    ("irb120", include_str!("irb120.toml")),
    ("irb1600-10-145", include_str!("irb1600-10-145.toml")),
    ("ur5", include_str!("ur5.toml")),
    ("ur10", include_str!("ur10.toml")),
    ("tx2-90l", include_str!("tx2-90l.toml")),
]
