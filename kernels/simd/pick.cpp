// Body of pick in memory.py.
number each[lanes];
for (int lane = 0; lane < lanes; ++lane)
    each[lane] = x.data[places.data[first + lane]];
return as_value(*runs(each));
