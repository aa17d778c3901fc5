// Body of load_as in memory.py.
number each[lanes];
for (int lane = 0; lane < lanes; ++lane)
    each[lane] = number(x.data[i + lane]);
return as_value(*runs(each));
