// Body of pick in memory.py.
const auto at = places.data + first;
return as_value(each_lane([&](int lane) { return x.data[at[lane]]; }));
