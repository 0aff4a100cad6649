"""The two atomic changes of a record, as Redis runs them.

KEYS[1] record, KEYS[2] its stream of events. Every change: check what the caller expects, then
write the fields, move the id between the per-state indexes, append an event, wake the waiters.
"""

from __future__ import annotations

# ARGV: id, fields (JSON object), index prefix, feed channel, events kept, queue cap (0: none)
CREATE = """
if redis.call('EXISTS', KEYS[1]) == 1 then return {'exists'} end
local cap = tonumber(ARGV[6])
if cap > 0 and redis.call('ZCARD', ARGV[3] .. 'queued') >= cap then return {'full'} end
local t = redis.call('TIME')
local now = string.format('%d', t[1] * 1000 + math.floor(t[2] / 1000))
for name, value in pairs(cjson.decode(ARGV[2])) do redis.call('HSET', KEYS[1], name, value) end
redis.call('HSET', KEYS[1], 'created_at', now, 'updated_at', now, 'queued_at', now)
redis.call('ZADD', ARGV[3] .. 'queued', now, ARGV[1])
redis.call('ZADD', ARGV[3] .. 'all', now, ARGV[1])
redis.call('XADD', KEYS[2], 'MAXLEN', '~', ARGV[5], '*', 'event', 'state', 'data',
           '{"state": "queued"}')
redis.call('PUBLISH', ARGV[4], ARGV[1])
return {'ok', 'queued', '1'}
"""

# ARGV: id, expected fields (JSON), states it may be in (",a,b,"), new state ("": stays),
#       fields (JSON), stamp field ("": none), 1 if the attempt number grows, event name ("": none),
#       event data, index prefix, feed channel, events kept
CHANGE = """
local state = redis.call('HGET', KEYS[1], 'state')
if not state then return {'missing'} end
for name, value in pairs(cjson.decode(ARGV[2])) do
  if (redis.call('HGET', KEYS[1], name) or '') ~= value then return {'fenced', state, name} end
end
if not string.find(ARGV[3], ',' .. state .. ',', 1, true) then return {'illegal', state} end
local t = redis.call('TIME')
local now = string.format('%d', t[1] * 1000 + math.floor(t[2] / 1000))
for name, value in pairs(cjson.decode(ARGV[5])) do redis.call('HSET', KEYS[1], name, value) end
redis.call('HSET', KEYS[1], 'updated_at', now)
if ARGV[6] ~= '' then redis.call('HSET', KEYS[1], ARGV[6], now) end
if ARGV[7] == '1' then redis.call('HINCRBY', KEYS[1], 'attempt', 1) end
if ARGV[4] ~= '' and ARGV[4] ~= state then
  redis.call('HSET', KEYS[1], 'state', ARGV[4])
  redis.call('ZREM', ARGV[10] .. state, ARGV[1])
  redis.call('ZADD', ARGV[10] .. ARGV[4], now, ARGV[1])
  state = ARGV[4]
end
if ARGV[8] ~= '' then
  redis.call('XADD', KEYS[2], 'MAXLEN', '~', ARGV[12], '*', 'event', ARGV[8], 'data', ARGV[9])
  redis.call('PUBLISH', ARGV[11], ARGV[1])
end
return {'ok', state, redis.call('HGET', KEYS[1], 'attempt'),
        redis.call('HGET', KEYS[1], 'cancel') or ''}
"""

# ARGV: id, lease. Renewing says nothing to anyone: it only keeps the number of beats moving.
RENEW = """
if redis.call('HGET', KEYS[1], 'state') ~= 'running' then return {'ended'} end
if redis.call('HGET', KEYS[1], 'lease') ~= ARGV[2] then return {'fenced'} end
redis.call('HINCRBY', KEYS[1], 'beats', 1)
return {'ok', redis.call('HGET', KEYS[1], 'cancel') or ''}
"""

# ARGV: id, index prefix
REMOVE = """
if redis.call('EXISTS', KEYS[1]) == 0 then return {'missing'} end
for _, state in ipairs({'queued', 'running', 'succeeded', 'failed', 'cancelled', 'expired', 'all'})
do redis.call('ZREM', ARGV[2] .. state, ARGV[1]) end
redis.call('DEL', KEYS[1], KEYS[2])
return {'ok'}
"""
